"""The appliance's life on a machine: installing, updating, uninstalling, looking it over, and packing a report."""
