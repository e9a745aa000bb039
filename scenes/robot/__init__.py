"""Hands, their sensors and fingertips."""
