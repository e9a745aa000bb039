"""Estimators of papers that work on contacts alone, to compare with and to choose."""
