"""What people use: command line, commands, campaigns, reports, demonstrations and the operator's page."""
