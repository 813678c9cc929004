"""The loop: it scores, refits and selects effects, decides the verdict and reports it. May import
`reporting`, `inference`, `audit` and the rooms below them."""
