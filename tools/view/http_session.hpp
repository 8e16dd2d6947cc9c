// SPDX-License-Identifier: Apache-2.0
// Serves one HTTP connection. Reads a request, checks access, and sends a file of the web
// page or an error. Passes WebSocket connections on to a SocketSession.
#pragma once

#include <optional>

#include <boost/asio/steady_timer.hpp>
#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/core/tcp_stream.hpp>
#include <boost/beast/http/empty_body.hpp>
#include <boost/beast/http/message.hpp>
#include <boost/beast/http/parser.hpp>
#include <boost/beast/http/string_body.hpp>

#include "socket_session.hpp"

namespace relidar::view {

class HttpSession : public std::enable_shared_from_this<HttpSession> {
public:
    HttpSession(boost::asio::ip::tcp::socket socket, WebServerState& hub);
    void read_request();
    /// Rejects the client, because too many connections are open.
    void send_overload();

private:
    using Request = boost::beast::http::request<boost::beast::http::empty_body>;
    using Response = boost::beast::http::response<boost::beast::http::string_body>;
    using Status = boost::beast::http::status;
    using Error = boost::system::error_code;

    void start_timeout(std::chrono::milliseconds max_duration);
    void on_read(Error error);
    void answer_request(const Request& request);
    std::string_view offered_protocol(const Request& request) const;
    std::optional<Status> access_error(const Request& request, bool foxglove) const;
    Response make_response(Status status, const std::string& host) const;
    void send_error(Status status);
    void write_response();
    void discard_rest();

    WebServerState& hub_;
    CountedConnection counted_;
    boost::beast::tcp_stream stream_;
    boost::asio::steady_timer timer_;
    bool late_ = false;  ///< True if the timer has cancelled a read or write.
    int n_discards_ = 0;
    boost::beast::flat_buffer buffer_;
    std::optional<boost::beast::http::request_parser<boost::beast::http::empty_body>> parser_;
    std::optional<Response> response_;
};

}  // namespace relidar::view
