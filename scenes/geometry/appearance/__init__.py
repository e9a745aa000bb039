"""How an object looks: the depth image a camera would see of it, and what is printed on it."""
