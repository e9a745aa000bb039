"""Time against error, beside other methods and libraries."""
