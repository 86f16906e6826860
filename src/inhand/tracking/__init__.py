"""Following hand and object from image to image; built on the stages of the estimator."""
