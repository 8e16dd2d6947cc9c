// SPDX-License-Identifier: Apache-2.0
#include "server.hpp"

#include <future>
#include <random>
#include <thread>

#include <fmt/format.h>
#include <boost/asio/executor_work_guard.hpp>
#include <boost/asio/ip/host_name.hpp>
#include <boost/asio/post.hpp>

#include "base/fail.hpp"

#include "http_session.hpp"

namespace relidar::view {
namespace {

using boost::asio::ip::tcp;
using ErrorCode = boost::system::error_code;

// If the system has no free file descriptor.
constexpr std::chrono::milliseconds kAcceptPause{50};
constexpr std::chrono::milliseconds kClosePollInterval{5};

boost::asio::ip::address parse_address(const std::string& address_text) {
    ErrorCode failed;
    const auto address = boost::asio::ip::make_address(address_text, failed);
    if (failed)
        fail<UsageError>(
            "cannot listen on the address \"{}\", expected an IP address such as 127.0.0.1, 0.0.0.0 or ::1",
            address_text);
    return address;
}

/// Opens a socket that listens on the address of the options.
tcp::acceptor open_acceptor(boost::asio::io_context& io_context, const WebServerOptions& options) {
    const tcp::endpoint endpoint(parse_address(options.address), static_cast<std::uint16_t>(options.port));
    ErrorCode failed;
    tcp::acceptor acceptor(io_context);
    acceptor.open(endpoint.protocol(), failed);
    if (!failed) acceptor.set_option(tcp::acceptor::reuse_address(true), failed);
    if (!failed) acceptor.bind(endpoint, failed);
    if (!failed) acceptor.listen(tcp::acceptor::max_listen_connections, failed);
    if (failed)
        fail<UsageError>(
            "cannot listen on port {} of {}: {}; use a free port, or port 0 to select one automatically",
            options.port, options.address, failed.message());
    return acceptor;
}

}  // namespace

struct WebServer::Impl {
    WebServerState hub;
    /// Keeps the thread of the server running even if no connection is open.
    boost::asio::executor_work_guard<boost::asio::io_context::executor_type> busy =
        boost::asio::make_work_guard(hub.io);
    tcp::acceptor acceptor;
    boost::asio::steady_timer pause;
    std::thread thread = {};

    Impl(const WebServerOptions& options, WebSocketEvents events)
        : hub{options, std::move(events), "", ""}, acceptor(open_acceptor(hub.io, options)), pause(hub.io) {
        hub.cookie_name = fmt::format("relidar_{}", acceptor.local_endpoint().port());
        ErrorCode failed;
        hub.host_name = boost::asio::ip::host_name(failed);
    }

    /// Accepts the next connection and then calls itself. Clients above the limit receive
    /// an error message, and clients above twice the limit are disconnected immediately.
    void start_accepting() {
        acceptor.async_accept([this](ErrorCode failed, tcp::socket socket) {
            if (!acceptor.is_open()) return;  // The acceptor is closed because drain() was called.
            if (failed) {
                pause.expires_after(kAcceptPause);
                pause.async_wait([this](ErrorCode) {
                    if (acceptor.is_open()) start_accepting();
                });
                return;
            }
            const bool is_below_connection_limit = hub.n_connections < hub.options.max_connections;
            const auto session = std::make_shared<HttpSession>(std::move(socket), hub);
            if (is_below_connection_limit) session->read_request();
            else if (hub.n_connections < 2 * hub.options.max_connections) session->send_overload();
            start_accepting();
        });
    }

    /// Calls a function with the session of a client on the thread of the server. Does
    /// nothing if the client has disconnected.
    template <class Work>
    void post_session(ClientId client_id, Work call_session) {
        boost::asio::post(hub.io, [this, client_id, work = std::move(call_session)]() mutable {
            const auto match = hub.clients.find(client_id);
            if (match == hub.clients.end()) return;
            if (const auto session = match->second.lock()) work(*session);
        });
    }

    /// A binary message is a scan, which replaces older scans that are still queued.
    void post_message(ClientId client_id, std::string bytes, bool is_text) {
        post_session(client_id, [is_text, bytes = std::move(bytes)](SocketSession& session) mutable {
            session.send_message(std::move(bytes), is_text, !is_text);
        });
    }
};

WebServer::WebServer(const WebServerOptions& options, WebSocketEvents events)
    : impl_(new Impl(options, std::move(events))) {
    impl_->start_accepting();
    impl_->thread = std::thread([&impl = *impl_] { impl.hub.io.run(); });
}

void WebServer::drain(std::chrono::milliseconds max_wait) {
    const auto end = std::chrono::steady_clock::now() + max_wait;
    boost::asio::post(impl_->hub.io, [&impl = *impl_] {
        ErrorCode ignored;
        impl.acceptor.close(ignored);
        // Iterates over a copy, because a session that ends immediately removes itself
        // from the original list.
        const auto clients = impl.hub.clients;
        for (const auto& [id, client] : clients)
            if (const auto session = client.lock()) session->drain();
    });
    // Polls on the thread of the server, because only that thread may use the list.
    bool has_clients = true;
    while (has_clients && std::chrono::steady_clock::now() < end) {
        std::promise<bool> result;
        boost::asio::post(impl_->hub.io, [&] { result.set_value(!impl_->hub.clients.empty()); });
        has_clients = result.get_future().get();
        std::this_thread::sleep_for(kClosePollInterval);
    }
}

WebServer::~WebServer() {
    impl_->hub.io.stop();
    impl_->thread.join();
}

int WebServer::port() const { return impl_->acceptor.local_endpoint().port(); }

std::string WebServer::page_url() const {
    const auto address = impl_->acceptor.local_endpoint().address();
    std::string host = address.is_unspecified() ? "127.0.0.1" : address.to_string();
    if (address.is_v6() && !address.is_unspecified()) host = "[" + host + "]";
    const std::string& token = impl_->hub.options.token;
    return fmt::format("http://{}:{}/{}", host, port(), token.empty() ? "" : "?token=" + token);
}

void WebServer::send_text(ClientId client_id, std::string text) {
    impl_->post_message(client_id, std::move(text), true);
}
void WebServer::send_newest(ClientId client_id, std::string scan_message) {
    impl_->post_message(client_id, std::move(scan_message), false);
}
void WebServer::send_batch(ClientId client_id, std::vector<std::string> messages) {
    impl_->post_session(client_id, [messages = std::move(messages)](SocketSession& session) mutable {
        session.send_batch(std::move(messages));
    });
}

void check_address(const std::string& address) { (void)parse_address(address); }

std::string make_token() {
    std::random_device source;  // Random source of the operating system.
    std::string token;
    for (int i = 0; i < 4; ++i) token += fmt::format("{:08x}", static_cast<std::uint32_t>(source()));
    return token;
}

}  // namespace relidar::view
