"""Case files: the schema, one module per section, and the loader that names file, line and key."""
