"""From labelled centres to poses with covariance, and what is remembered of them."""
