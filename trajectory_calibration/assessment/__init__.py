"""How good a solution is: covariance, observability, checks of the input, priors."""
