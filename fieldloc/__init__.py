"""What a soccer robot sees of a known field and what that says about its pose. Knows no estimator, no file format."""
