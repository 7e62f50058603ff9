"""Files, the terminal, text and figures, whatever is written."""
