"""How sure an answer is, and how wide: moments, turns left open, verdict, confidence."""
