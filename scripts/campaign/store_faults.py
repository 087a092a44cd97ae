"""Faulty answers of an object store."""

import gzip
import time
from collections.abc import Callable, Iterator
from xml.sax.saxutils import escape

MOST_BYTES = 512 << 20
MOST_SECONDS = 40.0
"""Limits of an endless answer."""
CHUNK = b"10000\r\n" + b"A" * 0x10000 + b"\r\n"
OK = b"HTTP/1.1 200 OK\r\n"
TAG = b'Last-Modified: Wed, 01 Jan 2020 00:00:00 GMT\r\nETag: "x"\r\nConnection: close\r\n'
CHUNKED = OK + b"Transfer-Encoding: chunked\r\n"
CONTROL = b"\x1b]0;title\x07\x1b[31mred\xff\r\n" * 3000

Answer = Callable[["Handler"], Iterator[bytes]]
"""The parts of an answer to a request of a `store_server.Handler`."""


def with_length(length: object, body: bytes = b"abc", more: bytes = b"") -> Answer:
    """An answer that states a length."""
    stated = b"Content-Length: %s\r\n" % str(length).encode()
    return lambda _: iter([OK + stated + more + TAG + b"\r\n", body])


def endless(head: bytes, part: bytes, pause: float = 0.0) -> Answer:
    """A head, then the same part without end."""

    def answer(_: "Handler") -> Iterator[bytes]:
        yield head
        sent, until = 0, time.monotonic() + MOST_SECONDS
        while sent < MOST_BYTES and time.monotonic() < until:
            yield part
            sent += len(part)
            time.sleep(pause)

    return answer


def status(line: str, body: bytes = b"", more: bytes = b"") -> Answer:
    """An answer with another status."""
    head = b"HTTP/1.1 %s\r\nContent-Length: %d\r\n" % (line.encode(), len(body))
    return lambda _: iter([head + more + b"Connection: close\r\n\r\n", body])


def page(entries: str, more: str = "<IsTruncated>false</IsTruncated>") -> bytes:
    """A page of a listing."""
    text = f'<?xml version="1.0"?><ListBucketResult><Name>b</Name>{more}{entries}</ListBucketResult>'
    return text.encode()


def entry(key: str, size: object) -> str:
    """An object of a listing."""
    return (
        f"<Contents><Key>{escape(key)}</Key><LastModified>2020-01-01T00:00:00.000Z</LastModified>"
        f'<ETag>"x"</ETag><Size>{size}</Size></Contents>'
    )


def listing(entries: Callable[["Handler"], str], more: str = "") -> Answer:
    """A whole page."""
    body = lambda handler: page(entries(handler), more or "<IsTruncated>false</IsTruncated>")
    return lambda handler: with_length(len(body(handler)), body(handler))(handler)


def pages_without_end(handler: "Handler") -> Iterator[bytes]:
    """A full page that names another one."""
    now = time.monotonic_ns()
    keys = "".join(entry(f"{handler.prefix}a{now}-{k}/trajectory.npy", 100) for k in range(1000))
    more = f"<IsTruncated>true</IsTruncated><NextContinuationToken>{now}</NextContinuationToken>"
    return with_length(len(page(keys, more)), page(keys, more))(handler)


def objects(handler: "Handler", change: Callable[[str], str] = str, size: object = None) -> str:
    """The objects that are there, under changed names or with another size."""
    return "".join(entry(change(key), length if size is None else size) for key, length in handler.objects())


GZIP = b"Content-Encoding: gzip\r\n"
BOMB = gzip.compress(bytes(64 << 20))
ENTITIES = (
    '<?xml version="1.0"?><!DOCTYPE a [<!ENTITY a "aaaaaaaaaa">'
    + "".join(f'<!ENTITY {n} "{10 * f"&{o};"}">' for o, n in zip("abcdefghi", "bcdefghij"))
    + "]><ListBucketResult><Name>&j;</Name></ListBucketResult>"
).encode()
BODIES: dict[str, Answer] = {
    "ten bytes and endless chunks": endless(CHUNKED + b"Content-Length: 10\r\n" + TAG + b"\r\n", CHUNK),
    "endless chunks": endless(CHUNKED + TAG + b"\r\n", CHUNK),
    "endless": endless(OK + TAG + b"\r\n", b"A" * 0x10000),
    "trickle": endless(OK + b"Content-Length: 100000\r\n" + TAG + b"\r\n", b"A", 0.2),
    "trickle of a head": endless(OK, b"X-A: b\r\n", 0.2),
    "endless head": endless(OK, b"X-A: " + b"b" * 1000 + b"\r\n"),
    "endless line of a head": endless(OK + b"X-A: ", b"b" * 0x10000),
    "silence": endless(b"", b"", 0.2),
    "endless continue": endless(b"", b"HTTP/1.1 100 Continue\r\n\r\n"),
    "too short": with_length(100),
    "too long": with_length(2, b"abc" * 1000),
    "huge length": with_length((1 << 63) - 1),
    "larger length": with_length(1 << 70),
    "negative length": with_length(-1),
    "two lengths": with_length("3\r\nContent-Length: 300"),
    "length of no number": with_length("abc"),
    "no length": lambda _: iter([OK + TAG + b"\r\n", b"abc"]),
    "bad chunk": lambda _: iter([CHUNKED + TAG + b"\r\n", b"zz\r\nabc\r\n"]),
    "huge chunk": lambda _: iter([CHUNKED + TAG + b"\r\n", b"fffffffffffffff\r\nabc"]),
    "gzip bomb": with_length(len(BOMB), BOMB, GZIP),
    "bad gzip": with_length(3, b"abc", GZIP),
    "noise": lambda _: iter([b"\x00\xff\x1b[31m" * 1000 + b"\r\n\r\n"]),
    "nothing": lambda _: iter([]),
    "redirect to itself": lambda h: status("302 Found", more=b"Location: %s\r\n" % h.path.encode())(h),
    "redirect without end": lambda h: status(
        "302 Found", more=b"Location: %s?%d\r\n" % (h.path.encode(), time.monotonic_ns()))(h),
    "redirect to a file": status("302 Found", more=b"Location: file:///etc/passwd\r\n"),
    "redirect elsewhere": status("301 Moved", more=b"Location: http://127.0.0.1:1/x\r\n"),
    "redirect to nothing": status("302 Found"),
    "control characters": status("403 Forbidden", CONTROL),
    "endless refusal": endless(b"HTTP/1.1 403 Forbidden\r\nTransfer-Encoding: chunked\r\n\r\n", CHUNK),
    "reason with control characters": status("500 \x1b[31mred\x07"),
    "unavailable": status("503 Slow Down"),
    "wait for ever": status("429 Too Many", more=b"Retry-After: 999999999\r\n"),
    "partial": status("206 Partial Content", b"abc", b"Content-Range: bytes 5-7/9\r\n"),
    "no content": status("204 No Content"), "not modified": status("304 Not Modified"),
    "status 999": status("999 What"), "status 100": status("100 Continue"),
}
"""Answers to any request."""
LISTINGS: dict[str, Answer] = {
    "pages without end": pages_without_end,
    "same page again": listing(
        objects, "<IsTruncated>true</IsTruncated><NextContinuationToken>t</NextContinuationToken>"),
    "empty pages without end": listing(
        lambda _: "", "<IsTruncated>true</IsTruncated><NextContinuationToken>t</NextContinuationToken>"),
    "truncated without token": listing(objects, "<IsTruncated>true</IsTruncated>"),
    "long token": listing(
        lambda _: "", f"<IsTruncated>true</IsTruncated><NextContinuationToken>{'t' * 100_000}"
        "</NextContinuationToken>"),
    "entities": with_length(len(ENTITIES), ENTITIES),
    "deep": listing(lambda _: "<a>" * 200_000 + "</a>" * 200_000),
    "keys above": listing(lambda h: objects(h, lambda key: key.replace("/motion/", "/motion/../../"))),
    "keys elsewhere": listing(lambda h: objects(h, lambda key: "other/" + key)),
    "absolute keys": listing(lambda h: objects(h, lambda key: "/" + key)),
    "odd keys": listing(lambda h: objects(h, lambda key: key.replace("synth", "\u202e\u0085=x\n"))),
    "long keys": listing(lambda h: objects(h, lambda key: key.replace("synth", "x" * 100_000))),
    "negative sizes": listing(lambda h: objects(h, size=-1)),
    "huge sizes": listing(lambda h: objects(h, size=1 << 62)),
    "sizes beyond": listing(lambda h: objects(h, size=10**30)),
    "twice": listing(lambda h: 2 * objects(h)), "empty": listing(lambda _: ""),
    "another root": with_length(12, b"<html></html>"), "no text": with_length(6, b"\xff\xfe<a\x00>"),
}
"""Answers to the question for a listing."""
