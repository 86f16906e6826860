"""Small pure functions and data types for rigid motions, meshes and their sampling."""
