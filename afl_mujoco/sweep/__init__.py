"""Many independent units of work: shared among workers, kept as they finish, the same bits."""
