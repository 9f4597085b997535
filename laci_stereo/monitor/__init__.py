"""Where the objects of a long recording drive on the map, whatever the sensor."""
