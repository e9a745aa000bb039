"""The outline in the image as evidence: where the object ends, told by colour. Camera frame, metres, pixels."""
