"""Files of one format each: meshes, images, tables, JSON, pickles."""
