"""Seven optimisers on the search for gains: does the paper's find the optimum, and how fast?"""
