"""Output: files, terminal, text, figures."""
