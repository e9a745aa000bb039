"""What contacts say of each object that may have been touched: their likelihood, whatever its pose and their noise."""
