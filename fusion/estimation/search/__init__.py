"""Where modes come from: sources of proposals, the pool in which they compete, and the search over rows."""
