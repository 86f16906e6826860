"""The project's own hand and objects, made in code: for the demo, the tests and first trials."""
