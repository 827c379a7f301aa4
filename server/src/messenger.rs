//! Posts messages to addresses that users gave.
//!
//! Whoever may add a webhook chooses where the service connects to. So that nobody reaches through it what only the
//! service's own machine or network may reach (server-side request forgery), loopback, private and link-local addresses are
//! refused unless the service was told otherwise. Names are checked when they are resolved, at every connection, by what
//! they resolve to. Redirects are not followed and proxies not used: a message goes where it was asked for, or nowhere.

use std::error::Error;
use std::future::Future;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::pin::Pin;
use std::sync::{Arc, OnceLock};
use std::task::{Context, Poll};
use std::time::Duration;
use std::{io, vec};

use bytes::Bytes;
use http::{HeaderMap, Method, Request, Uri};
use http_body_util::Full;
use hyper_rustls::{ConfigBuilderExt, HttpsConnector, HttpsConnectorBuilder};
use hyper_util::client::legacy::Client;
use hyper_util::client::legacy::connect::HttpConnector;
use hyper_util::client::legacy::connect::dns::Name;
use hyper_util::rt::TokioExecutor;
use rustls::crypto::ring;
use rustls::{ClientConfig, RootCertStore};

/// From the first look-up to the head of the answer.
const TIMEOUT: Duration = Duration::from_secs(10);

/// Why an address is none that messages are sent to, in words.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum AddressError {
    #[error("must be an http or https address with a host")]
    NotWeb,
    #[error("must not hold a user name or a password: messages are signed instead")]
    Credentials,
    #[error("must not be a loopback, private or link-local address: `serve --webhook-allow-private` allows them")]
    Private,
}

type HttpClient = Client<HttpsConnector<HttpConnector<Resolver>>, Full<Bytes>>;

pub(crate) struct Messenger {
    resolver: Resolver,
    /// Made when the first message is sent: it reads the system's certificates.
    client: OnceLock<HttpClient>,
}

impl Messenger {
    pub(crate) fn new(allow_private: bool) -> Self {
        Self { resolver: Resolver { allow_private }, client: OnceLock::new() }
    }

    /// Reads an address, and refuses what can be refused before a name is looked up.
    ///
    /// # Errors
    /// What is wrong with it.
    pub(crate) fn check(&self, address: &str) -> Result<Uri, AddressError> {
        let url = reqwest::Url::parse(address).map_err(|_| AddressError::NotWeb)?;
        let host = url.host_str().unwrap_or_default();
        if !matches!(url.scheme(), "http" | "https") || host.is_empty() {
            return Err(AddressError::NotWeb);
        }
        if !url.username().is_empty() || url.password().is_some() {
            return Err(AddressError::Credentials);
        }
        // Names are checked when they are resolved; numbers never are.
        let number: Option<IpAddr> = host.trim_matches(['[', ']']).parse().ok();
        if number.is_some_and(|number| !self.resolver.allows(number)) {
            return Err(AddressError::Private);
        }
        url.as_str().parse().map_err(|_| AddressError::NotWeb)
    }

    /// Posts a body; the status of the answer, whose own body is not read.
    ///
    /// # Errors
    /// Why there was no answer, in words.
    pub(crate) async fn post(&self, address: &str, headers: HeaderMap, body: Bytes) -> Result<u16, String> {
        let uri = self.check(address).map_err(|error| format!("its address {error}"))?;
        let mut request = Request::new(Full::new(body));
        (*request.method_mut(), *request.uri_mut(), *request.headers_mut()) = (Method::POST, uri, headers);
        let client = self.client.get_or_init(|| new_client(self.resolver.clone()));
        match tokio::time::timeout(TIMEOUT, client.request(request)).await {
            Ok(Ok(response)) => Ok(response.status().as_u16()),
            Ok(Err(error)) => Err(format!("it cannot be reached: {}", root_cause(&error))),
            Err(_) => Err(format!("it did not answer within {} s", TIMEOUT.as_secs())),
        }
    }
}

fn new_client(resolver: Resolver) -> HttpClient {
    let mut http = HttpConnector::new_with_resolver(resolver);
    http.enforce_http(false);
    http.set_connect_timeout(Some(TIMEOUT));
    let connector =
        HttpsConnectorBuilder::new().with_tls_config(tls_config()).https_or_http().enable_http1().wrap_connector(http);
    // Messages are rare: connections are not kept.
    Client::builder(TokioExecutor::new()).pool_max_idle_per_host(0).build(connector)
}

/// Trusts what the system trusts. Where that is nothing, every https address fails with a reason, and http works.
fn tls_config() -> ClientConfig {
    let builder = || {
        let provider = Arc::new(ring::default_provider());
        let versions = ClientConfig::builder_with_provider(provider).with_safe_default_protocol_versions();
        versions.expect("ring has the cipher suites of every version")
    };
    match builder().with_native_roots() {
        Ok(trusting) => trusting.with_no_client_auth(),
        Err(error) => {
            tracing::warn!(%error, "the system has no certificates: no https webhook can be reached");
            builder().with_root_certificates(RootCertStore::empty()).with_no_client_auth()
        }
    }
}

fn root_cause(error: &dyn Error) -> String {
    let mut cause = error;
    while let Some(deeper) = cause.source() {
        cause = deeper;
    }
    cause.to_string()
}

/// Looks names up, and keeps of what it finds only what messages may be sent to.
#[derive(Clone, Debug)]
struct Resolver {
    allow_private: bool,
}

impl Resolver {
    fn allows(&self, address: IpAddr) -> bool {
        self.allow_private || is_public(address)
    }
}

impl tower::Service<Name> for Resolver {
    type Response = vec::IntoIter<SocketAddr>;
    type Error = io::Error;
    type Future = Pin<Box<dyn Future<Output = io::Result<Self::Response>> + Send>>;

    fn poll_ready(&mut self, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn call(&mut self, name: Name) -> Self::Future {
        let resolver = self.clone();
        Box::pin(async move {
            // The connector puts the port in.
            let found = tokio::net::lookup_host((name.as_str(), 0)).await?;
            let usable: Vec<SocketAddr> = found.filter(|address| resolver.allows(address.ip())).collect();
            if usable.is_empty() {
                return Err(io::Error::other("its name stands for no address, or only for private ones"));
            }
            Ok(usable.into_iter())
        })
    }
}

/// Whether an address is one of the open internet (IANA's registries of special-purpose addresses).
fn is_public(address: IpAddr) -> bool {
    match address {
        IpAddr::V4(v4) => is_public_v4(v4),
        IpAddr::V6(v6) => is_public_v6(v6),
    }
}

fn is_public_v4(address: Ipv4Addr) -> bool {
    let [a, b, c, _] = address.octets();
    let special = address.is_private()
        || address.is_loopback()
        || address.is_link_local()
        || address.is_multicast()
        || address.is_documentation()
        // "This network", shared by carriers, protocol assignments, benchmarks, reserved.
        || a == 0
        || (a == 100 && (64..128).contains(&b))
        || (a == 192 && b == 0 && c == 0)
        || (a == 198 && (b == 18 || b == 19))
        || a >= 240;
    !special
}

fn is_public_v6(address: Ipv6Addr) -> bool {
    let segments = address.segments();
    let v4 = |high: u16, low: u16| Ipv4Addr::from((u32::from(high) << 16) | u32::from(low));
    match segments {
        // Addresses of IPv4 inside: mapped, translated (RFC 6052), and 6to4.
        [0, 0, 0, 0, 0, 0xffff, high, low] | [0x64, 0xff9b, 0, 0, 0, 0, high, low] => is_public_v4(v4(high, low)),
        [0x2002, high, low, ..] => is_public_v4(v4(high, low)),
        // Only 2000::/3 is given to the internet; of it, documentation is not.
        [0x2001, 0xdb8, ..] => false,
        [first, ..] => first & 0xe000 == 0x2000,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_of_the_open_internet_are_told_from_others() {
        for public in ["93.184.216.34", "8.8.8.8", "172.32.0.1", "100.128.0.1", "2606:2800:220:1::1", "::ffff:8.8.8.8"]
        {
            assert!(is_public(public.parse().unwrap()), "{public}");
        }
        for special in [
            "127.0.0.1",
            "10.1.2.3",
            "172.16.0.1",
            "192.168.1.1",
            "169.254.169.254",
            "100.64.0.1",
            "0.0.0.0",
            "224.0.0.1",
            "255.255.255.255",
            "198.18.0.1",
            "::1",
            "::",
            "fe80::1",
            "fd00::1",
            "ff02::1",
            "::ffff:127.0.0.1",
            "::ffff:10.0.0.1",
            "64:ff9b::a00:1",
            "2002:7f00:1::",
            "2001:db8::1",
        ] {
            assert!(!is_public(special.parse().unwrap()), "{special}");
        }
    }

    #[test]
    fn addresses_are_refused_before_anything_is_sent() {
        let messenger = Messenger::new(false);
        assert!(messenger.check("https://chat.example/hook?x=1").is_ok());
        assert!(messenger.check("http://[2606:2800:220:1::1]:8080/").is_ok());
        for wrong in
            ["", "chat.example", "ftp://chat.example/", "file:///etc/passwd", "https://", "javascript:alert(1)"]
        {
            assert_eq!(messenger.check(wrong), Err(AddressError::NotWeb), "{wrong}");
        }
        assert_eq!(messenger.check("https://a:b@chat.example/"), Err(AddressError::Credentials));
        // Numbers have many spellings.
        for private in
            ["http://127.0.0.1/", "http://2130706433/", "http://0x7f.1/", "http://[::1]/", "http://[::ffff:7f00:1]/"]
        {
            assert_eq!(messenger.check(private), Err(AddressError::Private), "{private}");
            assert!(Messenger::new(true).check(private).is_ok(), "{private}");
        }
    }

    #[tokio::test]
    async fn a_name_is_judged_by_what_it_stands_for() {
        let error =
            Messenger::new(false).post("http://localhost:9/", HeaderMap::new(), Bytes::new()).await.unwrap_err();
        assert!(error.contains("private"), "{error}");
        let error = Messenger::new(true).post("http://localhost:9/", HeaderMap::new(), Bytes::new()).await.unwrap_err();
        assert!(error.contains("refused"), "{error}");
    }

    #[tokio::test]
    async fn tls_is_spoken_and_what_does_not_speak_it_is_told() {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = format!("https://{}/", listener.local_addr().unwrap());
        let hello = tokio::spawn(async move {
            use tokio::io::{AsyncReadExt, AsyncWriteExt};
            let (mut stream, _) = listener.accept().await.unwrap();
            let mut first = [0; 3];
            stream.read_exact(&mut first).await.unwrap();
            stream.write_all(b"HTTP/1.1 200 OK\r\n\r\n").await.unwrap();
            first
        });
        let error = Messenger::new(true).post(&address, HeaderMap::new(), Bytes::new()).await.unwrap_err();
        assert!(error.starts_with("it cannot be reached: "), "{error}");
        assert_eq!(hello.await.unwrap(), [22, 3, 1], "a client's hello (RFC 8446, section 5.1)");
    }
}
