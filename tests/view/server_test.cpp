// SPDX-License-Identifier: Apache-2.0
// Tests the viewer's server against arbitrary clients on the network.
#include <future>
#include <sstream>

#include <gmock/gmock.h>

#include <relidar/base/error.hpp>
#include "../../tools/view/server.hpp"
#include "../base/codecs/temporary_folder.hpp"
#include "raw_client.hpp"

namespace relidar::view {
namespace {

using std::chrono::milliseconds;
using test::ask;
using test::frame;
using test::make_upgrade_request;
using test::RawClient;
using test::status_of;
using testing::AnyOf;
using testing::HasSubstr;
using testing::Not;

constexpr const char* kToken = "0123456789abcdef0123456789abcdef";
const std::vector<WebPageFile> kAssets = {{"/", "text/html", "<p>the page</p>"},
                                          {"/main.js", "text/javascript", "let a = 1;"}};

struct Echo {
    WebServer server;

    explicit Echo(WebServerOptions options = {})
        : server(filled(options),
                 {[](ClientId) {},
                  [this](ClientId id, std::string text) {
                      last = id;
                      server.send_text(id, "echo " + text);
                  },
                  [](ClientId) {}, [this](ClientId id) { server.send_text(id, "foxglove"); }}) {}
    static WebServerOptions filled(WebServerOptions options) {
        options.port = 0;
        options.assets = kAssets;
        options.request_time = milliseconds(400);
        return options;
    }
    int port() const { return server.port(); }
    int status(std::string_view request) const { return status_of(ask(port(), request)); }
    bool is_server_alive() const { return status("GET / HTTP/1.0\r\nHost: localhost\r\n\r\n") != 0; }

    std::atomic<ClientId> last = 0;
};

std::string get(const std::string& target, const std::string& fields = "Host: localhost\r\n") {
    return "GET " + target + " HTTP/1.1\r\n" + fields + "Connection: close\r\n\r\n";
}

std::string make_foxglove_request(const std::string& origin, const std::string& target = "/") {
    return make_upgrade_request("Host: localhost:8080\r\nOrigin: " + origin +
                                    "\r\nSec-WebSocket-Protocol: foxglove.sdk.v1, foxglove.websocket.v1\r\n",
                                target);
}

std::string make_text_frame(std::string_view text) { return frame(0x81, text, true, text.size()); }

struct Socket : RawClient {
    explicit Socket(int port, const std::string& handshake = make_upgrade_request()) : RawClient(port) {
        send(handshake);
        for (std::string next; !answer.ends_with("\r\n\r\n") && !(next = receive(1)).empty();) answer += next;
    }
    std::string answer;
};

int close_code(const std::string& bytes) {
    const std::size_t at = bytes.rfind(static_cast<char>(0x88));
    if (at == std::string::npos || at + 4 > bytes.size()) return 0;
    return static_cast<unsigned char>(bytes[at + 2]) * 256 + static_cast<unsigned char>(bytes[at + 3]);
}

TEST(ViewServer, AcceptsFoxgloveFromKnownOriginsOrWithTheToken) {
    const Echo echo;
    for (const char* origin : {"https://app.foxglove.dev", "https://lichtblick-suite.github.io", "file://",
                               "http://localhost:3000", "http://127.0.0.1:3000", "http://localhost:8080"}) {
        Socket socket(echo.port(), make_foxglove_request(origin));
        EXPECT_EQ(status_of(socket.answer), 101) << origin;
        EXPECT_THAT(socket.answer, HasSubstr("Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n"));
        EXPECT_EQ(socket.receive(10), std::string("\x81\x08") + "foxglove")
            << "opened as a client of Foxglove";
    }
    for (const char* origin : {"http://evil.example", "null", "https://app.foxglove.dev.evil.example",
                               "http://localhost.evil.example", "http://127.0.0.1.evil.example:80"})
        EXPECT_EQ(echo.status(make_foxglove_request(origin)), 403) << origin;
    const std::string fields = "Host: localhost:8080\r\nOrigin: https://app.foxglove.dev\r\n";
    EXPECT_EQ(echo.status(make_upgrade_request(fields)), 403) << "not with the page's protocol";
    EXPECT_EQ(echo.status(get("/", fields)), 403);
    WebServerOptions options;
    options.token = kToken;
    const Echo locked(options);
    const std::string target = std::string("/?token=") + kToken;
    EXPECT_EQ(status_of(Socket(locked.port(), make_foxglove_request("http://any.example", target)).answer),
              101);
    EXPECT_EQ(locked.status(make_foxglove_request("http://any.example", target + "0")), 403);
    EXPECT_EQ(locked.status(make_foxglove_request("https://app.foxglove.dev")), 401);
}

TEST(ViewServer, ServesItsAssetsByTheirExactNames) {
    const Echo echo;
    const std::string page = ask(echo.port(), get("/"));
    EXPECT_EQ(status_of(page), 200);
    EXPECT_TRUE(page.ends_with("\r\n\r\n<p>the page</p>"));
    for (const char* field :
         {"Content-Security-Policy: default-src 'none'; script-src 'self';",
          "X-Content-Type-Options: nosniff", "Referrer-Policy: no-referrer", "Content-Type: text/html"})
        EXPECT_THAT(page, HasSubstr(field));
    EXPECT_THAT(page, Not(HasSubstr("unsafe")));
    EXPECT_THAT(ask(echo.port(), get("/main.js?x=1")), HasSubstr("let a = 1;"));
    const std::string head =
        ask(echo.port(), "HEAD / HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n");
    EXPECT_THAT(head, HasSubstr("Content-Length: 15\r\n"));
    EXPECT_TRUE(head.ends_with("\r\n\r\n"));
}

struct WorkingFolder {
    const ScratchFolder scratch;
    const std::filesystem::path before = std::filesystem::current_path();

    WorkingFolder() { std::filesystem::current_path(scratch.path); }
    ~WorkingFolder() { std::filesystem::current_path(before); }
};

TEST(ViewServer, ServesNothingElse) {
    const Echo echo;
    const WorkingFolder here;
    std::ofstream("main.css") << "a file beside the program";
    std::istringstream paths(R"(/main.css /../main.js /./main.js //main.js /../../../../etc/passwd /main.js/
        /%2e%2e/%2e%2e/etc/passwd /..%2f..%2fetc/passwd /..\..\etc\passwd /main.js%00.html /MAIN.JS
        /etc/passwd main.js * file:///etc/passwd http://localhost/main.js /main.js;x /%6dain.js /. /.. /live/)");
    for (std::string path; paths >> path;) {
        const std::string answer = ask(echo.port(), get(path));
        EXPECT_THAT(status_of(answer), AnyOf(404, 400)) << path;
        EXPECT_THAT(answer,
                    Not(AnyOf(HasSubstr("root:"), HasSubstr("beside the program"), HasSubstr("let a"))))
            << path;
    }
    EXPECT_EQ(echo.status(get("/live")), 426);
    EXPECT_TRUE(echo.is_server_alive());
}

TEST(ViewServer, RefusesWhatIsNoRequestForAnAsset) {
    const Echo echo;
    const std::string host = "Host: localhost\r\n";
    const std::vector<std::pair<std::string, int>> cases = {
        {"POST / HTTP/1.1\r\n" + host + "\r\n", 405},
        {"DELETE /main.js HTTP/1.1\r\n" + host + "\r\n", 405},
        {"TRACE / HTTP/1.1\r\n" + host + "\r\n", 405},
        {"POST / HTTP/1.1\r\n" + host + "Content-Length: 1000000000000\r\n\r\nabc", 413},
        {"GET / HTTP/1.1\r\n" + host + "Content-Length: 1\r\n\r\na", 413},
        {"POST / HTTP/1.1\r\n" + host + "Transfer-Encoding: chunked\r\n\r\nffffffff\r\nabc", 413},
        {"GET / HTTP/1.1\r\n" + host + "Content-Length: -1\r\n\r\n", 400},
        {"GET / HTTP/1.1\r\n" + host + "Content-Length: 99999999999999999999999999\r\n\r\n", 400},
        {"GET / HTTP/1.1\r\n" + host + "X: " + std::string(10000, 'x') + "\r\n\r\n", 431},
        {"GET /" + std::string(10000, 'x') + " HTTP/1.1\r\n" + host + "\r\n", 431},
        {"GET / HTTP/9.9\r\n" + host + "\r\n", 400},
        {"GET /\r\n\r\n", 400},
        {std::string("\0\1\2\3\r\n\r\n", 8), 400},
        {"GET / HTTP/1.1\r\n" + host + "bad header\r\n\r\n", 400},
        {"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03 a TLS client\r\n\r\n", 400}};
    for (const auto& [request, status] : cases) {
        EXPECT_EQ(echo.status(request), status) << request.substr(0, 60);
        EXPECT_TRUE(echo.is_server_alive());
    }
}

TEST(ViewServer, KnowsItsOwnNamesAndNoOther) {
    const Echo echo;
    for (const char* host :
         {"localhost", "LocalHost:8080", "127.0.0.1", "127.0.0.1:9", "[::1]:8080", "[::1]", "192.168.3.4:80"})
        EXPECT_EQ(echo.status(get("/", std::string("Host: ") + host + "\r\n")), 200) << host;
    for (const char* host :
         {"evil.example", "localhost.evil.example", "127.0.0.1.evil.example", "evil.example:8080",
          "localhost:80:80", "[::1", "[::1]x", "localhost:x", "a@localhost"})
        EXPECT_EQ(echo.status(get("/", std::string("Host: ") + host + "\r\n")), 403) << host;
    EXPECT_EQ(echo.status(get("/", "")), 400);
    EXPECT_EQ(echo.status(get("/", "Host: localhost\r\nHost: evil.example\r\n")), 400);
}

TEST(ViewServer, RefusesForeignPages) {
    const Echo echo;
    const std::string host = "Host: localhost:8080\r\n";
    for (const char* origin : {"http://evil.example", "http://localhost", "http://localhost:8081",
                               "https://localhost:8080", "null", "x"}) {
        const std::string fields = host + "Origin: " + origin + "\r\n";
        EXPECT_EQ(echo.status(get("/", fields)), 403) << origin;
        EXPECT_EQ(echo.status(make_upgrade_request(fields)), 403) << origin;
    }
    EXPECT_EQ(
        status_of(
            Socket(echo.port(), make_upgrade_request(host + "Origin: http://localhost:8080\r\n")).answer),
        101);
    EXPECT_EQ(echo.status(make_upgrade_request("Host: evil.example\r\nOrigin: http://evil.example\r\n")),
              403);
}

TEST(ViewServer, LetsInWhoShowsTheTokenAlone) {
    WebServerOptions options;
    options.token = kToken;
    const Echo echo(options);
    const std::string host = "Host: localhost\r\n", cookie = "relidar_" + std::to_string(echo.port());
    const std::string close_one = std::string(kToken).substr(0, 31);
    for (const std::string& target :
         {std::string("/"), std::string("/?token="), "/?token=" + close_one, "/?token=" + close_one + "e",
          "/?token=" + std::string(kToken) + "0", "/?tokem=" + std::string(kToken), std::string("/main.js"),
          std::string("/nothing")})
        EXPECT_EQ(echo.status(get(target)), 401) << target;
    EXPECT_EQ(echo.status(get("/", host + "Cookie: " + cookie + "=" + close_one + "\r\n")), 401);
    EXPECT_EQ(echo.status(make_upgrade_request()), 401);

    const std::string page = ask(echo.port(), get("/?token=" + std::string(kToken)));
    EXPECT_EQ(status_of(page), 200);
    EXPECT_THAT(
        page, HasSubstr("Set-Cookie: " + cookie + "=" + kToken + "; Path=/; HttpOnly; SameSite=Strict\r\n"));
    const std::string shown = host + "Cookie: other=1; " + cookie + "=" + kToken + "\r\n";
    EXPECT_EQ(echo.status(get("/main.js", shown)), 200);
    EXPECT_EQ(status_of(Socket(echo.port(), make_upgrade_request(shown)).answer), 101);
    EXPECT_THAT(echo.server.page_url(), HasSubstr(std::string("/?token=") + kToken));
}

TEST(ViewServer, HangsUpOnSlowClients) {
    const Echo echo;
    RawClient half(echo.port());
    half.send("GET / HTTP/1.1\r\nHost: loc");
    EXPECT_EQ(status_of(half.receive()), 408);

    // Each byte arrives within the time limit, but the complete request takes too long.
    RawClient drop_by_drop(echo.port());
    const auto start = std::chrono::steady_clock::now();
    for (const char c : get("/" + std::string(400, 'x'))) {
        if (!drop_by_drop.send(std::string(1, c))) break;
        std::this_thread::sleep_for(milliseconds(5));
        if (std::chrono::steady_clock::now() - start > milliseconds(1500)) break;
    }
    EXPECT_EQ(status_of(drop_by_drop.receive()), 408);
    RawClient silent(echo.port());
    EXPECT_EQ(silent.receive(), "");  // closed without an answer
    EXPECT_LT(std::chrono::steady_clock::now() - start, std::chrono::seconds(10));
    EXPECT_TRUE(echo.is_server_alive());
}

TEST(ViewServer, TurnsAwayMoreThanItHasRoomFor) {
    WebServerOptions options;
    options.max_connections = 4;
    const Echo echo(options);
    {
        std::vector<std::unique_ptr<Socket>> guests;
        for (int i = 0; i < 4; ++i) guests.push_back(std::make_unique<Socket>(echo.port()));
        for (const auto& guest : guests) EXPECT_EQ(status_of(guest->answer), 101);
        EXPECT_EQ(echo.status(get("/")), 503);
    }
    int status = 503;
    for (int i = 0; i < 50 && status == 503; ++i) {
        // until the server has noticed that they disconnected
        std::this_thread::sleep_for(milliseconds(20));
        status = echo.status(get("/"));
    }
    EXPECT_EQ(status, 200);
}

TEST(ViewServer, AnswersWhileManyConnectionsAreSilent) {
    const WebServerOptions options;
    const Echo echo(options);
    Socket page(echo.port());  // was connected before
    std::vector<std::unique_ptr<RawClient>> silent;
    for (std::size_t i = 0; i < 3 * options.max_connections; ++i)
        silent.push_back(std::make_unique<RawClient>(echo.port()));
    page.send(make_text_frame("there"));
    EXPECT_EQ(page.receive(12), std::string("\x81\x0a") + "echo there");
    const auto start = std::chrono::steady_clock::now();
    int status = 0;
    while (status != 200 && std::chrono::steady_clock::now() - start < std::chrono::seconds(5)) {
        status = echo.status(get("/"));
        std::this_thread::sleep_for(milliseconds(20));
    }
    EXPECT_EQ(status, 200) << "the server closes silent connections, although their clients keep them open";
}

TEST(ViewServer, AnswersTexts) {
    const Echo echo;
    Socket socket(echo.port());
    ASSERT_EQ(status_of(socket.answer), 101);
    // from the example in RFC 6455
    EXPECT_THAT(socket.answer, HasSubstr("s3pPLMBiTxaQ9kYGzzhZRbK+xOo="));
    socket.send(make_text_frame("one"));
    EXPECT_EQ(socket.receive(10), std::string("\x81\x08") + "echo one");
    socket.send(frame(0x01, "t", true, 1) + frame(0x80, "wo", true, 2));  // in two fragments
    EXPECT_EQ(socket.receive(10), std::string("\x81\x08") + "echo two");
    socket.send(frame(0x89, "x", true, 1));
    EXPECT_EQ(socket.receive(3), std::string("\x8a\x01x"));  // ping, pong
}

TEST(ViewServer, ClosesOnFramesThatAreNone) {
    WebServerOptions options;
    options.max_message_bytes = 1000;
    const Echo echo(options);
    const std::vector<std::pair<std::string, int>> cases = {
        {frame(0x81, "unmasked", false, 8), 1002},
        {frame(0xf1, "reserved bits", true, 13), 1002},
        {frame(0x83, "reserved opcode", true, 15), 1002},
        {frame(0x80, "continues nothing", true, 17), 1002},
        {frame(0x09, "fragmented ping", true, 15), 1002},
        {frame(0x89, std::string(126, 'p'), true, 126), 1002},
        {frame(0x81, "\xff\xfe", true, 2), 1007},
        {frame(0x82, "binary", true, 6), 1003},
        {frame(0x81, std::string(1001, 'x'), true, 1001), 1009},
        {frame(0x81, "x", true, std::uint64_t(1) << 40), 1009},
        {frame(0x81, "x", true, UINT64_MAX), 1009}};
    for (const auto& [bytes, code] : cases) {
        Socket socket(echo.port());
        socket.send(bytes);
        const std::string answer = socket.receive();
        EXPECT_EQ(close_code(answer), code) << testing::PrintToString(bytes.substr(0, 20));
        EXPECT_THAT(answer, Not(HasSubstr("echo")));
        EXPECT_TRUE(echo.is_server_alive());
    }
    for (const char* broken : {"Sec-WebSocket-Version: 13", "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ=="}) {
        std::string request = make_upgrade_request();
        request.erase(request.find(broken), std::string(broken).size() + 2);
        EXPECT_THAT(echo.status(request), AnyOf(400, 426)) << broken;
    }
}

TEST(ViewServer, SendsTheNewestToWhoReadsSlowly) {
    Echo echo;
    Socket socket(echo.port());
    socket.send(make_text_frame("hello"));
    socket.receive(12);
    constexpr std::size_t kSize = std::size_t(1) << 22;  // larger than the buffers of the system
    for (char c = 'a'; c <= 'z'; ++c) echo.server.send_newest(echo.last, std::string(kSize, c));
    // The same thread answers this request, so the server has processed all earlier
    // messages.
    EXPECT_TRUE(echo.is_server_alive());
    const std::string all = socket.receive(SIZE_MAX, milliseconds(500));
    EXPECT_EQ(all.size(), 2 * (kSize + 10));  // the message being sent, and the last message
    EXPECT_EQ(all.back(), 'z');
}

TEST(ViewServer, GivesUpOnWhoNeverReads) {
    Echo echo;
    Socket socket(echo.port());
    socket.send(make_text_frame("hello"));
    socket.receive(12);
    for (int i = 0; i < 200; ++i) echo.server.send_text(echo.last, std::string(1 << 20, 'x'));
    EXPECT_TRUE(echo.is_server_alive());  // the server has processed all messages
    EXPECT_LT(socket.receive(SIZE_MAX, milliseconds(500)).size(), std::size_t(100) << 20);
    EXPECT_TRUE(echo.is_server_alive());
}

TEST(ViewServer, SaysWhereItCannotListen) {
    const Echo echo;
    WebServerOptions used_port_options;
    used_port_options.port = echo.port();
    const auto listen = [](const WebServerOptions& options) { const WebServer server(options, {}); };
    EXPECT_THROW(listen(used_port_options), UsageError);
    WebServerOptions nowhere;
    nowhere.address = "example.com";
    EXPECT_THROW(listen(nowhere), UsageError);
    EXPECT_THROW(check_address("x"), UsageError);
    EXPECT_NO_THROW(check_address("::1"));
    EXPECT_NE(make_token(), make_token());
    EXPECT_EQ(make_token().size(), 32u);
}

TEST(ViewServer, ClosesOnceWhatWaitsHasBeenSent) {
    Echo echo;
    const int port = echo.port();
    Socket socket(port), other(port);
    socket.send(make_text_frame("hello"));
    ASSERT_THAT(socket.receive(12), HasSubstr("echo hello"));
    const std::string large(std::size_t(8) << 20, 'x');  // larger than a single write of the system
    echo.server.send_newest(echo.last, large);
    auto closed = std::async(std::launch::async, [&] { echo.server.drain(std::chrono::seconds(20)); });
    const std::string received = socket.receive();
    EXPECT_EQ(received.size(),
              10 + large.size() + 2 + 2 + std::string("the program is shutting down").size());
    EXPECT_EQ(close_code(received), 1001);
    EXPECT_EQ(close_code(other.receive()), 1001);
    socket.abort();
    other.abort();
    EXPECT_EQ(closed.wait_for(std::chrono::seconds(10)), std::future_status::ready);
    EXPECT_THROW(RawClient{port}, std::exception);  // the server accepts no more connections
}

TEST(ViewServer, EndsAtOnceWhateverIsOpen) {
    auto echo = std::make_unique<Echo>();
    const Socket idle(echo->port());
    RawClient half(echo->port());
    half.send("GET /");
    const auto start = std::chrono::steady_clock::now();
    echo.reset();
    EXPECT_LT(std::chrono::steady_clock::now() - start, milliseconds(500));
}

}  // namespace
}  // namespace relidar::view
