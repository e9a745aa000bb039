"""Gel sensors against point contacts, on simulated presses, hands with a camera, and recorded grasps."""
