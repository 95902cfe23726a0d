"""Bus load, planned and measured: response times, plans and logs."""
