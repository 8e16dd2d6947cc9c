// SPDX-License-Identifier: Apache-2.0
#include "server.hpp"

#include <future>
#include <random>
#include <thread>

#include <fmt/format.h>
#include <boost/asio/executor_work_guard.hpp>
#include <boost/asio/ip/host_name.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/steady_timer.hpp>

#include <relidar/base/error.hpp>

#include "http_session.hpp"
#include "hub.hpp"
#include "socket_session.hpp"

namespace relidar::view {
namespace {

using boost::asio::ip::tcp;
using ErrorCode = boost::system::error_code;

// Pause before the next attempt if the system has no free file descriptor.
constexpr std::chrono::milliseconds kAcceptPause{50};
// Interval at which close() checks whether all connections are closed.
constexpr std::chrono::milliseconds kCloseLook{5};

boost::asio::ip::address parse_address(const std::string& text) {
    ErrorCode failed;
    const auto address = boost::asio::ip::make_address(text, failed);
    if (failed)
        throw UsageError(fmt::format(
            "cannot listen on the address \"{}\", expected an IP address such as 127.0.0.1, 0.0.0.0 "
            "or ::1",
            text));
    return address;
}

tcp::acceptor listen(boost::asio::io_context& io, const ServerOptions& options) {
    const tcp::endpoint endpoint(parse_address(options.address), static_cast<std::uint16_t>(options.port));
    ErrorCode failed;
    tcp::acceptor acceptor(io);
    acceptor.open(endpoint.protocol(), failed);
    if (!failed) acceptor.set_option(tcp::acceptor::reuse_address(true), failed);
    if (!failed) acceptor.bind(endpoint, failed);
    if (!failed) acceptor.listen(tcp::acceptor::max_listen_connections, failed);
    if (failed)
        throw UsageError(
            fmt::format("cannot listen on port {} of {}: {}; use a free port, or port 0 to select one "
                        "automatically",
                        options.port, options.address, failed.message()));
    return acceptor;
}

std::string get_machine_name() {
    ErrorCode failed;
    return boost::asio::ip::host_name(failed);
}

}  // namespace

struct Server::Impl {
    Hub hub;
    /// Keeps the thread of the server running even if no connection is open.
    boost::asio::executor_work_guard<boost::asio::io_context::executor_type> busy =
        boost::asio::make_work_guard(hub.io);
    tcp::acceptor acceptor;
    boost::asio::steady_timer pause;
    std::thread thread = {};

    Impl(const ServerOptions& options, Events events)
        : hub{options, std::move(events), "", get_machine_name()},
          acceptor(listen(hub.io, options)),
          pause(hub.io) {
        hub.cookie_name = fmt::format("relidar_{}", acceptor.local_endpoint().port());
    }

    void accept() {
        acceptor.async_accept([this](ErrorCode failed, tcp::socket socket) {
            if (!acceptor.is_open()) return;  // The acceptor is closed because close() was called.
            if (failed) {
                pause.expires_after(kAcceptPause);
                pause.async_wait([this](ErrorCode) {
                    if (acceptor.is_open()) accept();
                });
                return;
            }
            const bool has_room = hub.n_connections < hub.options.max_connections;
            const auto session = std::make_shared<HttpSession>(std::move(socket), hub);
            if (has_room) session->read();
            else if (hub.n_connections < 2 * hub.options.max_connections) session->refuse_connection();
            accept();
        });
    }

    /// Calls a function with the session of a client in the thread of the server. Does
    /// nothing if the client has disconnected.
    template <class Work>
    void post_to(ClientId client, Work work) {
        boost::asio::post(hub.io, [this, client, work = std::move(work)]() mutable {
            const auto match = hub.clients.find(client);
            if (match == hub.clients.end()) return;
            if (const auto session = match->second.lock()) work(*session);
        });
    }

    void send(ClientId client, std::string bytes, bool is_text) {
        post_to(client, [is_text, bytes = std::move(bytes)](SocketSession& session) mutable {
            session.send(std::move(bytes), is_text, !is_text);
        });
    }
};

Server::Server(const ServerOptions& options, Events events) : impl_(new Impl(options, std::move(events))) {
    impl_->accept();
    impl_->thread = std::thread([&impl = *impl_] { impl.hub.io.run(); });
}

void Server::close(std::chrono::milliseconds patience) {
    const auto end = std::chrono::steady_clock::now() + patience;
    boost::asio::post(impl_->hub.io, [&impl = *impl_] {
        ErrorCode ignored;
        impl.acceptor.close(ignored);
        // Iterates over a copy, because a session that ends immediately removes itself
        // from the original list.
        const auto clients = impl.hub.clients;
        for (const auto& [id, client] : clients)
            if (const auto session = client.lock()) session->leave();
    });
    for (bool all_gone = false; !all_gone && std::chrono::steady_clock::now() < end;
         std::this_thread::sleep_for(kCloseLook)) {
        std::promise<bool> none;
        boost::asio::post(impl_->hub.io, [&] { none.set_value(impl_->hub.clients.empty()); });
        all_gone = none.get_future().get();
    }
}

Server::~Server() {
    impl_->hub.io.stop();
    impl_->thread.join();
}

int Server::port() const { return impl_->acceptor.local_endpoint().port(); }

std::string Server::url() const {
    const auto address = impl_->acceptor.local_endpoint().address();
    std::string host = address.is_unspecified() ? "127.0.0.1" : address.to_string();
    if (address.is_v6() && !address.is_unspecified()) host = "[" + host + "]";
    const std::string& token = impl_->hub.options.token;
    return fmt::format("http://{}:{}/{}", host, port(), token.empty() ? "" : "?token=" + token);
}

void Server::send_text(ClientId client, std::string text) { impl_->send(client, std::move(text), true); }
void Server::send_newest(ClientId client, std::string bytes) { impl_->send(client, std::move(bytes), false); }
void Server::send_if_idle(ClientId client, std::vector<std::string> messages) {
    impl_->post_to(client, [messages = std::move(messages)](SocketSession& session) mutable {
        session.send_if_idle(std::move(messages));
    });
}

void check_address(const std::string& address) { (void)parse_address(address); }

std::string make_random_token() {
    std::random_device source;  // Random source of the operating system.
    std::string token;
    for (int i = 0; i < 4; ++i) token += fmt::format("{:08x}", static_cast<std::uint32_t>(source()));
    return token;
}

}  // namespace relidar::view
