"""The commands of the daemon: their table, their handlers, and the server of the command lane."""
