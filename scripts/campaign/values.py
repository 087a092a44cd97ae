"""Values of settings and options, of their type and out of range."""

VALUES = [
    "0", "1", "-1", "2", "3", "0.5", "-0.0", "1e-300", "1e300", "1e20", "65536", "2147483648",
    "4294967296", "9007199254740992", "9223372036854775807", "99999999999999999999", "nan", "inf",
    "-inf", '""', "zzz", "true", "[]", "[0.5]", "[-1, 1]", "[nan, inf]", "[[1]]", "{}",
]
"""In the syntax of `--set KEY=VALUE`, for every key."""
WORDS_OF_SETTINGS = ['"../x"', '"a/b"', '"."', '"*"', '"\\u0000"', '"\\n"', '"ünï"', '["a", "a"]', "[{}]"]
"""For keys of words."""
LONG = "x" * 100_000

WORDS = [
    "0", "1", "-1", "2", "3", "0.5", "-0.5", "-0", "1e-300", "1e300", "1e20", "1e400", "65536",
    "2147483648", "4294967295", "4294967296", "9007199254740992", "9223372036854775807",
    "18446744073709551615", "18446744073709551616", "nan", "inf", "-inf", "", " ", "zzz", "*", "a/b",
    "missing/folder/file", "a#b", "a#0:99999999999", "ünï", "\x01",
]
"""In the syntax of options. No path is outside the case's folder, because options name output
files."""
