"""Terms of learned functions. `slider close-loop` describes a residual with a learned function if
no effect of the library explains the residual, or if the named effects are doubtful. Each file
contains the terms of one place."""
