"""Pictures and animations of results, drawn with matplotlib."""
