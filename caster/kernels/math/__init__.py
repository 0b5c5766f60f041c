"""Vector algebra, error-free transformations and roots of quadratics with error bounds."""
