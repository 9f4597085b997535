"""Where does a roadside sensor stand, and where does it look?"""
