"""What a frame says that is not so: images and contacts of another instant, a lens or a camera that was changed."""
