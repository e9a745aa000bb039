"""Infra-red light: how it is thrown, swung back and forth between surfaces, and falls into pixels."""
