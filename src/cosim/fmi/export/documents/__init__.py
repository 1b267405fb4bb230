"""What an FMU says to people: a page, its pictures, its equations, files that belong to it."""
