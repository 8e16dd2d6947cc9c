# SPDX-License-Identifier: Apache-2.0
"""Compares what a message names, instead of its wording."""
import re


def names(message, parts):
    """Returns whether the message contains, in this order, the parts that " ... " separates:
    names(text, "a.csv ... line 3 ... 40 m")."""
    return re.search(".*".join(map(re.escape, parts.split(" ... "))), message, re.DOTALL) is not None
