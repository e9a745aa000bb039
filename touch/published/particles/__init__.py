"""Particles over poses: filters contact by contact, and searches that grow finer."""
