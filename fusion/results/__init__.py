"""What a person gets: files, reports, views, many captures at once."""
