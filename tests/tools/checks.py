# SPDX-License-Identifier: Apache-2.0
"""What the Python tests of the tools share."""
import sys

failures = []


def check(what, condition):
    """Remembers a failure, which finish() prints."""
    if not condition:
        failures.append(what)


def finish():
    """Prints the failures and ends with code 1 if there are any."""
    print("\n".join(failures))
    sys.exit(1 if failures else 0)


def expect(condition, text):
    """Ends the test at the first failure."""
    if not condition:
        sys.exit(f"FAILED: {text}")


def render_service(address, certificate=None):
    """Returns the stubs v1 and the client of a `relidar serve`. The folder tools/examples must be
    in sys.path."""
    import grpc
    from closed_loop_client import v1, v1_grpc   # generates the stubs
    options = [("grpc.max_receive_message_length", -1)]
    if certificate:
        credentials = grpc.ssl_channel_credentials(open(certificate, "rb").read())
        return v1, v1_grpc.RenderServiceStub(grpc.secure_channel(address, credentials, options=options))
    return v1, v1_grpc.RenderServiceStub(grpc.insecure_channel(address, options=options))
