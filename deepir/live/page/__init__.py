"""A page in the browser that shows corrected frames as they come."""
