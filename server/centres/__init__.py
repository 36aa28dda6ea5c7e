"""From spots to sub-pixel centres with covariance."""
