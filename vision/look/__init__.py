"""From a frame's pixels to what may be the object, the hand, and what was seen to be empty."""
