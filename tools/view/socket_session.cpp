// SPDX-License-Identifier: Apache-2.0
#include "socket_session.hpp"

#include <algorithm>

#include <boost/asio/buffer.hpp>
#include <boost/beast/core/buffers_to_string.hpp>
#include <boost/beast/websocket/rfc6455.hpp>

namespace relidar::view {

namespace websocket = boost::beast::websocket;

// A client that is too slow to receive them is disconnected.
constexpr std::size_t kMaxWaiting = 64;

/// Sets the limits of the WebSocket. The connection starts with accept_handshake().
SocketSession::SocketSession(boost::beast::tcp_stream stream, CountedConnection counted, WebServerState& hub)
    : hub_(hub), counted_(std::move(counted)), stream_(std::move(stream)) {
    // turns off the timer of the TCP stream, because the WebSocket has its own timer
    stream_.next_layer().expires_never();
    websocket::stream_base::timeout limits;
    limits.handshake_timeout = hub.options.request_time;
    limits.idle_timeout = hub.options.idle_time;
    limits.keep_alive_pings = true;  // A ping after half of this time tests whether the client answers.
    stream_.set_option(limits);
    stream_.read_message_max(hub.options.max_message_bytes);
    // Sends each message as one WebSocket frame. Fragments are useless, because the
    // server sends no other message between them.
    stream_.auto_fragment(false);
}

void SocketSession::accept_handshake(
    const boost::beast::http::request<boost::beast::http::empty_body>& upgrade_request,
    std::string_view protocol) {
    const bool is_foxglove = !protocol.empty();
    // The response must name the subprotocol that this server has selected.
    if (is_foxglove)
        stream_.set_option(websocket::stream_base::decorator([protocol](websocket::response_type& response) {
            response.set(boost::beast::http::field::sec_websocket_protocol,
                         boost::beast::string_view(protocol.data(), protocol.size()));
        }));
    stream_.async_accept(upgrade_request, [self = shared_from_this(), is_foxglove](Error failed) {
        if (failed) return;
        self->id_ = ++self->hub_.last_client;
        self->hub_.clients[self->id_] = self;
        const WebSocketEvents& events = self->hub_.events;
        if (is_foxglove) events.foxglove_opened(self->id_);
        else events.opened(self->id_);
        self->read_message();
    });
}

void SocketSession::read_message() {
    stream_.async_read(incoming_,
                       [self = shared_from_this()](Error failed, std::size_t) { self->on_read(failed); });
}

/// Passes a received text on and waits for the next message.
void SocketSession::on_read(Error error) {
    // The client has disconnected, or its message is invalid or too large. For an invalid
    // message, the stream has already sent the error code.
    if (error) return leave_hub();
    if (!stream_.got_text()) return close_invalid();
    std::string text = boost::beast::buffers_to_string(incoming_.data());
    incoming_.consume(incoming_.size());
    hub_.events.message(id_, std::move(text));
    read_message();
}

/// Adds a message to the queue of an open connection. Disconnects a client whose queue is
/// full, because it is too slow.
/// @param newest_only  removes waiting messages that have this mark too, such as scans
void SocketSession::send_message(std::string bytes, bool is_text, bool newest_only) {
    const bool is_open = id_ != 0 && !refused_;
    if (!is_open) return;
    if (newest_only && outgoing_.size() > 1) {
        // The first message stays, because it is already being written.
        const auto is_stale = [](const OutgoingMessage& message) { return message.newest_only; };
        outgoing_.erase(std::remove_if(outgoing_.begin() + 1, outgoing_.end(), is_stale), outgoing_.end());
    }
    if (outgoing_.size() >= kMaxWaiting) {
        leave_hub();
        boost::beast::get_lowest_layer(stream_).close();
        return;
    }
    outgoing_.push_back({std::move(bytes), is_text, newest_only});
    if (outgoing_.size() == 1) write_message();
}

void SocketSession::send_batch(std::vector<std::string> messages) {
    if (id_ == 0 || refused_ || messages.empty() || !outgoing_.empty()) return;
    for (std::string& bytes : messages) outgoing_.push_back({std::move(bytes), false, false});
    write_message();
}

void SocketSession::write_message() {
    stream_.text(outgoing_.front().is_text);
    stream_.async_write(boost::asio::buffer(outgoing_.front().bytes),
                        [self = shared_from_this()](Error failed, std::size_t) { self->on_write(failed); });
}

void SocketSession::on_write(Error error) {
    if (error) return leave_hub();
    outgoing_.pop_front();
    if (refused_) return close_invalid();
    if (!outgoing_.empty()) write_message();
    else if (leaving_) close_with_reason(websocket::close_code::going_away, "the program is shutting down");
}

void SocketSession::drain() {
    leaving_ = true;
    if (id_ != 0 && outgoing_.empty())
        close_with_reason(websocket::close_code::going_away, "the program is shutting down");
}

void SocketSession::close_with_reason(std::uint16_t code, const char* reason) {
    if (std::exchange(said_goodbye_, true)) return;
    stream_.async_close({websocket::close_code(code), reason},
                        [self = shared_from_this()](Error) { self->leave_hub(); });
}

/// Closes the connection to a client that has sent an invalid message. Waits until the
/// current write is finished, because only one write may run at a time.
void SocketSession::close_invalid() {
    refused_ = true;
    if (!outgoing_.empty()) {
        outgoing_.erase(outgoing_.begin() + 1, outgoing_.end());
        return;
    }
    close_with_reason(websocket::close_code::unknown_data, "found a binary message, expected a text message");
}

void SocketSession::leave_hub() {
    if (id_ == 0) return;
    const ClientId id = std::exchange(id_, 0);
    hub_.clients.erase(id);
    hub_.events.closed(id);
}

}  // namespace relidar::view
