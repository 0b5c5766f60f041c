"""What a process does with files, the terminal and signals, for the commands of both packages."""
