"""The schema of machine files: tables, ranges and rules, with every mistake as a sentence.

pydantic finds the mistakes; it is imported nowhere else.
"""
