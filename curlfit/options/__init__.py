"""Options that verbs share: flags, configuration files, settings."""
