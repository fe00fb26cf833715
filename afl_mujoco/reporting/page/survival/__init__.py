"""Whether the controllers survive: the sentences and tables that the page has of the studies."""
