"""What we show: tables and figures."""
