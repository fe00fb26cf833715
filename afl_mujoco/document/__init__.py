"""What a report is made of - sections of text, tables, figures - and its writers; no study."""
