"""A hand that closes on an object, and hides as much of it as asked."""
