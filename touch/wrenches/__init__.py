"""Contacts from forces and torques (intrinsic contact sensing)."""
