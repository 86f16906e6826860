"""The stages of the pipeline, one module each: typed dataclass in, typed dataclass out."""
