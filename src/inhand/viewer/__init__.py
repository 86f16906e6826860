"""A web page that shows frames, estimates and what led to them (needs the `viewer` extra)."""
