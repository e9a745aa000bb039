"""Tactile arrays measured."""
