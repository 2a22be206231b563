"""What a machine file may say: its tables, ranges and rules, and every mistake as a sentence.

pydantic finds the mistakes; it is imported nowhere else.
"""
