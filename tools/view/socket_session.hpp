// SPDX-License-Identifier: Apache-2.0
// Serves one WebSocket connection.
#pragma once

#include <cstdint>
#include <deque>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/core/tcp_stream.hpp>
#include <boost/beast/http/empty_body.hpp>
#include <boost/beast/http/message.hpp>
#include <boost/beast/websocket/stream.hpp>

#include "hub.hpp"

namespace relidar::view {

class SocketSession : public std::enable_shared_from_this<SocketSession> {
public:
    SocketSession(boost::beast::tcp_stream stream, CountedConnection counted, WebServerState& hub);
    /// @param foxglove_protocol selected subprotocol of Foxglove; empty for the web page
    void accept_handshake(const boost::beast::http::request<boost::beast::http::empty_body>& upgrade_request,
                          std::string_view foxglove_protocol);
    void send_or_queue_message(std::string bytes, bool is_text, bool drop_queued_older_message);
    /// Skips all of them if earlier messages are still queued.
    void send_messages_if_queue_is_empty(std::vector<std::string> messages);
    void close_after_sending_queued_messages();

private:
    struct OutgoingMessage {
        std::string bytes;
        bool is_text;
        bool newest_only;
    };
    using Error = boost::system::error_code;

    void start_reading_message();
    void handle_read_result(Error error);
    void start_writing_message();
    void handle_write_result(Error error);
    void close_because_of_invalid_message();
    void close_with_reason(std::uint16_t code, const char* reason);
    void remove_client_from_hub();

    WebServerState& hub_;
    CountedConnection counted_;
    boost::beast::websocket::stream<boost::beast::tcp_stream> stream_;
    boost::beast::flat_buffer incoming_;
    std::deque<OutgoingMessage> outgoing_;  ///< Queued messages. The first message is already being written.
    /// id of the client; 0 before the handshake and after the connection is closed
    ClientId id_ = 0;
    bool refused_ = false;
    bool leaving_ = false;
    bool said_goodbye_ = false;
};

}  // namespace relidar::view
