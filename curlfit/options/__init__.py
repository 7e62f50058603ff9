"""Options that verbs share: flags, files of settings, what they ask for."""
