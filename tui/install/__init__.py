"""Installing, updating and uninstalling the services; the doctor's checks; the support report."""
