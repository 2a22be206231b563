"""The quickest print whose error stays under a bound."""
