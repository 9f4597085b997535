"""The optional vehicle mask: a user's network determines which of the moving points belong to vehicles."""
