"""Terms with which `slider close-loop` describes a residual that no effect of the library explains.
Each file contains the terms of one place."""
