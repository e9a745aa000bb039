"""Gel sensors: from images of a pressed skin to patches of the object's surface, and to poses."""
