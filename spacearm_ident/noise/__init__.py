"""What residuals say of themselves: weights, autocorrelation, standard errors, what differs between recordings."""
