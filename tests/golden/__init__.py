"""Golden results: small stacks and training steps of every kind, held against a record of them.

`python -m tests.golden` says what differs from the record, bit by bit, and `--renew` writes the record anew. A change
that only moves code moves no bit on one machine; a record that is renewed needs a reason in its commit.
"""
