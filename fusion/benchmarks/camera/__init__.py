"""Vision alone measured, and the scenes themselves."""
