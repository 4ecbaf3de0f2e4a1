"""What every room stands on: errors, files and how they get onto the disk, memory, threads, devices, colours."""
