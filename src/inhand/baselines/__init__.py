"""Other methods under the estimator's interface, to compare with; none is needed by the core."""
