"""Values of settings and options, of their type and out of range, and names of files."""

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

NAMES = [
    b"\xff\xfe", b"caf\xe9", b"\xc3\x28", b"\x9b31m", b"\xed\xa0\x80", b"a\x1b[31mred", b"a\x1b]0;t\x07",
    b"\x07", b"\x08\x08", b"a\nerror: b", b"\n", b"a\rb", b"a\tb", b"\x7f", b"\xc2\x9b31m",
    "\u202egpj".encode(), "\u2028".encode(), "\ufeff".encode(), "cafe\u0301".encode(),
    b"-x", b"--help", b"--", b"-", b"=1+1", b"+1", b"@x", b"#x", b"a#0", b"%s%n%20", b"..a", b"...",
    b" ", b" a ", b"a b", b"a'b", b'a"b', b"`a`$(b)", b"a\\b", b"a:b", b"file:a", b"*", b"[a]", b"{a}",
    b"~", b"$HOME", b"<img src=x onerror=y>", b"a]]>", b"</script>", b"&amp;", b"null", b"CON",
    b"x" * 100, b"x" * 200, b"x" * 240, b"x" * 250, b"x" * 255, b"x" * 300, "é".encode() * 124,
]
"""Names of files, without the ending. None has a slash."""
