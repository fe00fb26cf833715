"""What studies are made of: the contract, runs, rows, tables, records, searches."""
