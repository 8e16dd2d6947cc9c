// SPDX-License-Identifier: Apache-2.0
#include "socket_session.hpp"

#include <algorithm>

#include <boost/asio/buffer.hpp>
#include <boost/beast/core/buffers_to_string.hpp>
#include <boost/beast/websocket/rfc6455.hpp>

namespace relidar::view {

namespace websocket = boost::beast::websocket;

// Maximum number of queued messages for a client. A client that is too slow to receive
// them is disconnected.
constexpr std::size_t kMaxWaiting = 64;

SocketSession::SocketSession(boost::beast::tcp_stream stream, Counted counted, Hub& hub)
    : hub_(hub), counted_(std::move(counted)), stream_(std::move(stream)) {
    // turns off the timer of the TCP stream, because the WebSocket has its own timer
    stream_.next_layer().expires_never();
    websocket::stream_base::timeout limits{hub.options.request_time, hub.options.idle_time, true};
    stream_.set_option(limits);
    stream_.read_message_max(hub.options.max_message_bytes);
    // Sends each message as one WebSocket frame. Fragments are useless, because the
    // server sends no other message between them.
    stream_.auto_fragment(false);
}

void SocketSession::start(const boost::beast::http::request<boost::beast::http::empty_body>& upgrade,
                          std::string_view foxglove_protocol) {
    const bool is_foxglove = !foxglove_protocol.empty();
    if (is_foxglove)
        stream_.set_option(
            websocket::stream_base::decorator([foxglove_protocol](websocket::response_type& response) {
                response.set(boost::beast::http::field::sec_websocket_protocol,
                             boost::beast::string_view(foxglove_protocol.data(), foxglove_protocol.size()));
            }));
    stream_.async_accept(upgrade, [self = shared_from_this(), is_foxglove](Error failed) {
        if (failed) return;
        self->id_ = ++self->hub_.last_client;
        self->hub_.clients[self->id_] = self;
        const Events& events = self->hub_.events;
        (is_foxglove ? events.foxglove_opened : events.opened)(self->id_);
        self->read();
    });
}

void SocketSession::read() {
    stream_.async_read(incoming_,
                       [self = shared_from_this()](Error failed, std::size_t) { self->on_read(failed); });
}

void SocketSession::on_read(Error failed) {
    // The client has disconnected, or its message is invalid or too large. For an invalid
    // message, the stream has already sent the error code.
    if (failed) return finish();
    if (!stream_.got_text()) return refuse();
    std::string text = boost::beast::buffers_to_string(incoming_.data());
    incoming_.consume(incoming_.size());
    hub_.events.message(id_, std::move(text));
    read();
}

void SocketSession::send(std::string bytes, bool is_text, bool newest_only) {
    if (id_ == 0 || refused_) return;
    // Removes older scans from the queue, except the first message, which is already
    // being written.
    if (newest_only) {
        const auto stale = [](const Message& m) { return m.newest_only; };
        if (outgoing_.size() > 1)
            outgoing_.erase(std::remove_if(outgoing_.begin() + 1, outgoing_.end(), stale), outgoing_.end());
    }
    if (outgoing_.size() >= kMaxWaiting) {
        finish();
        boost::beast::get_lowest_layer(stream_).close();
        return;
    }
    outgoing_.push_back({std::move(bytes), is_text, newest_only});
    if (outgoing_.size() == 1) write();
}

void SocketSession::send_if_idle(std::vector<std::string> messages) {
    if (id_ == 0 || refused_ || messages.empty() || !outgoing_.empty()) return;
    for (std::string& bytes : messages) outgoing_.push_back({std::move(bytes), false, false});
    write();
}

void SocketSession::write() {
    stream_.text(outgoing_.front().is_text);
    stream_.async_write(boost::asio::buffer(outgoing_.front().bytes),
                        [self = shared_from_this()](Error failed, std::size_t) { self->on_written(failed); });
}

void SocketSession::on_written(Error failed) {
    if (failed) return finish();
    outgoing_.pop_front();
    if (refused_) return refuse();
    if (!outgoing_.empty()) write();
    else if (leaving_) close_with_reason(websocket::close_code::going_away, "the program is shutting down");
}

void SocketSession::leave() {
    leaving_ = true;
    if (id_ != 0 && outgoing_.empty())
        close_with_reason(websocket::close_code::going_away, "the program is shutting down");
}

void SocketSession::close_with_reason(std::uint16_t code, const char* why) {
    if (std::exchange(said_goodbye_, true)) return;
    stream_.async_close({websocket::close_code(code), why},
                        [self = shared_from_this()](Error) { self->finish(); });
}

/// Closes the connection to a client that has sent an invalid message. Waits until the
/// current write is finished.
void SocketSession::refuse() {
    refused_ = true;
    if (!outgoing_.empty()) {
        outgoing_.erase(outgoing_.begin() + 1, outgoing_.end());
        return;
    }
    close_with_reason(websocket::close_code::unknown_data, "expected a text message");
}

void SocketSession::finish() {
    if (id_ == 0) return;
    const ClientId id = std::exchange(id_, 0);
    hub_.clients.erase(id);
    hub_.events.closed(id);
}

}  // namespace relidar::view
