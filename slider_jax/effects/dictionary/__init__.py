"""Terms of learned functions. `slider close-loop` describes a residual with a learned function if
no effect of the library explains the residual well. Each file contains the terms of one place."""
