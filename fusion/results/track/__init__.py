"""What a track leaves behind while it runs, how it goes on after a stop, and its report."""
