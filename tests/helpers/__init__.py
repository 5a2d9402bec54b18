"""What several files of tests build on: balances, records, programs at work, pages; no test is here."""
