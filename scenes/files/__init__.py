"""Files in and out: tables, images, meshes, clouds, BOP's JSON; each reader says what is wrong and where."""
