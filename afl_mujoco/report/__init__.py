"""The blocks of a report - sections of text, tables, figures - and their writers; no study."""
