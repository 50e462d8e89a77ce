"""The analysis of one's own model, as a notebook."""
