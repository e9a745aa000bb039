"""Answers against ground truth."""
