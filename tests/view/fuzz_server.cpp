// SPDX-License-Identifier: Apache-2.0
// Sends modified requests and frames to the viewer's server: view_fuzz [REQUESTS [SEED]]
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <random>
#include <vector>

#include "../../tools/view/server.hpp"
#include "raw_client.hpp"

namespace {

using namespace relidar;

const std::vector<view::WebPageFile> kAssets = {{"/", "text/html", "page"},
                                                {"/main.js", "text/javascript", "let a;"}};
constexpr int kTogether = 8;         // requests per connection
constexpr int kBetweenChecks = 500;  // requests between checks

class Changer {
public:
    explicit Changer(unsigned seed) : random_(seed) {}
    std::size_t below(std::size_t count) {
        return std::uniform_int_distribution<std::size_t>(0, count - 1)(random_);
    }

    std::string request() {
        static const std::vector<std::string> seeds = {
            "GET / HTTP/1.1\r\nHost: localhost\r\n\r\n",
            "GET /main.js?token=abc&x=1 HTTP/1.1\r\nHost: 127.0.0.1:8080\r\nCookie: relidar_1=abc; b=2\r\n"
            "Origin: http://127.0.0.1:8080\r\n\r\n",
            "POST / HTTP/1.1\r\nHost: localhost\r\nContent-Length: 5\r\n\r\nhello",
            "POST / HTTP/1.1\r\nHost: [::1]:80\r\nTransfer-Encoding: chunked\r\n\r\n5\r\nhello\r\n0\r\n\r\n",
            "HEAD /../../etc/passwd HTTP/1.0\r\nHost: localhost\r\nConnection: keep-alive\r\n\r\n",
            test::make_upgrade_request(),
            test::make_upgrade_request("Host: localhost\r\nOrigin: http://localhost:80\r\n"
                                       "Sec-WebSocket-Protocol: foxglove.sdk.v1, foxglove.websocket.v1\r\n",
                                       "/")};
        return changed(seeds[below(seeds.size())]);
    }
    std::string frame() {
        const std::string text = "{\"do\": \"scan\", \"id\": 1}";
        return changed(test::frame(static_cast<std::uint8_t>(below(256)), text, below(8) != 0,
                                   below(4) != 0 ? text.size() : std::size_t(1) << below(63)));
    }

private:
    std::string changed(std::string text) {
        static const std::string long_text(300, 'A'), zero(1, '\0');
        static const std::vector<std::string> pieces = {"\r\n",    "\r\n\r\n",
                                                        zero,      "%00",
                                                        "..",      "/",
                                                        ":",       "Host: evil\r\n",
                                                        long_text, "Content-Length: 99999999999\r\n",
                                                        " ",       "\xff",
                                                        "[",       "]"};
        for (std::size_t n = below(6); n > 0 && !text.empty(); --n) {
            const std::size_t at = below(text.size());
            const std::size_t kind = below(5);
            if (kind == 0) text[at] = static_cast<char>(below(256));
            else if (kind == 1) text.erase(at, 1 + below(8));
            else if (kind == 2) text.insert(at, pieces[below(pieces.size())]);
            else if (kind == 3) text.insert(at, text.substr(at, 1 + below(40)));
            else text.resize(at);
        }
        return text;
    }

    std::mt19937 random_;
};

bool is_server_alive(int port) {
    return test::status_of(
               test::ask(port, "GET / HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")) == 200;
}

void bother(int port, Changer& change) {
    test::RawClient client(port);
    const bool as_socket = change.below(3) == 0;
    if (as_socket) {
        client.send(test::make_upgrade_request());
        // A client may send frames only after the response to the handshake.
        client.receive(100, std::chrono::milliseconds(200));
    }
    for (int i = 0; i < kTogether; ++i)
        if (!client.send(as_socket ? change.frame() : change.request())) break;
    if (change.below(2) == 0) client.receive(1 + change.below(2000), std::chrono::milliseconds(2));
    client.abort();
}

int run(int n_requests, unsigned seed) {
    view::WebServerOptions options;
    options.port = 0;
    options.assets = kAssets;
    options.request_time = std::chrono::milliseconds(500);
    options.max_message_bytes = 4096;
    view::WebServer* server = nullptr;
    const auto echo = [&](view::ClientId id, std::string text) { server->send_text(id, std::move(text)); };
    view::WebServer made(options,
                         {[](view::ClientId) {}, echo, [](view::ClientId) {}, [](view::ClientId) {}});
    server = &made;
    Changer change(seed);
    for (int sent = 0; sent < n_requests; sent += kTogether) {
        bother(made.port(), change);
        const bool is_last = sent + kTogether >= n_requests;
        if ((sent % kBetweenChecks < kTogether || is_last) && !is_server_alive(made.port())) {
            std::fprintf(stderr, "view_fuzz: no answer after %d requests, seed %u\n", sent, seed);
            return 1;
        }
    }
    std::printf("view_fuzz: %d requests and frames, seed %u: the server answers as before\n", n_requests,
                seed);
    return 0;
}

}  // namespace

int main(int argc, char** argv) {
    try {
        return run(argc > 1 ? std::atoi(argv[1]) : 3000,
                   argc > 2 ? static_cast<unsigned>(std::atoi(argv[2])) : 1u);
    } catch (const std::exception& error) {
        std::fprintf(stderr, "view_fuzz: %s\n", error.what());
        return 1;
    }
}
