"""The report of a capture: one HTML file that shows what the estimator saw, thought and answered."""
