"""What may go wrong around a command: kills, full disks, damaged files, hostile names. docs/evidence/reliability.md."""
