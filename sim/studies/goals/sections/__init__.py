"""The sections of the evaluation, one module each with a function `evaluate(context)`."""
