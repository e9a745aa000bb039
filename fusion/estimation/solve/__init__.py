"""The pose together with everything that makes the senses disagree."""
