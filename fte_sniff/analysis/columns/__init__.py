"""Many rows side by side: packed in numpy arrays, and as polars frames with the contract's names.

It must not know who asks. One row at a time is the business of `protocol`.

    packing         rows in a numpy array, and back
    fields          kinds and field values out of many rows at once
    short_names     short names of kinds and values, for where there is little room
    side_by_side    what rows side by side are
    tiles           what the framer decided to rows side by side
    bulk            many bytes to columns, at the machine's speed
    table           rows to a polars frame with the contract's names, in the smallest types
    wide            such a frame made wide, as the filter computes with it
"""
