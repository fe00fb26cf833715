"""The commands that ask whether the controllers survive a physics that is not ideal."""
