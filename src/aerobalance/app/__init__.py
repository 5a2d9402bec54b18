"""What people use: command line, commands, reports, demonstrations and the operator's page."""
