"""What the page is made from: report, figures and films, read and held to their form."""
