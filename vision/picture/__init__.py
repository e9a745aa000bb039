"""The predicted picture: what a camera would have to see if the object were at a pose, and what that is worth."""
