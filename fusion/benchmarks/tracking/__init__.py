"""Sequences of an object in a hand: who follows it, how well, how fast?"""
