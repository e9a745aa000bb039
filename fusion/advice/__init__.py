"""What an answer is good for: where to touch next, how the grasp holds."""
