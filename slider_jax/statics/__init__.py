"""Static cases of a rod in three dimensions: their files, and the report of `slider statics`."""
