"""What is found about data and results: codes with numbers, whose words stand in
`messages.toml`."""

from curlfit.findings.finding import Finding, Level, Remedy

__all__ = ["Finding", "Level", "Remedy"]
