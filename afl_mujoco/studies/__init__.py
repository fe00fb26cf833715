"""The studies: one folder each, found by `registry`; what two of them need lies beside them."""
