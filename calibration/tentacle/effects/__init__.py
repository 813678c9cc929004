"""Effects that the stated arm lacks: one file and one class for each physical cause."""
