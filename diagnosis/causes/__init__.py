"""From residuals to probable effects with intervals."""
