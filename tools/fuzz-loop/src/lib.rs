//! Everything in overcam that reads what others wrote, as functions of a file's bytes, and files to
//! begin with.
//!
//! Two programs call them: `fuzz-loop` with mutated files, on any compiler, and the targets in
//! `fuzz/` with what `libFuzzer` makes up, which needs a nightly one. An input may be refused; it
//! must not panic, take seconds, or take memory for what it merely claims.

pub mod folder;
pub mod mutation;
pub mod readers;
pub mod seeds;

/// A kind of file.
pub struct Format {
    /// What it is called on the command line.
    pub name: &'static str,
    /// Reads a file to its end; false if it was refused.
    pub read: fn(&[u8]) -> bool,
    /// Small files that are read without complaint.
    pub seeds: fn() -> Vec<Vec<u8>>,
    /// What such files are written with.
    pub words: &'static [&'static str],
}

/// All of them.
pub const FORMATS: [Format; 7] = [
    Format {
        name: "y4m",
        read: readers::y4m,
        seeds: seeds::y4m,
        words: &[
            "FRAME\n",
            "FRAME ",
            " W",
            " H",
            " F30:1",
            " F1:0",
            " A1:1",
            " A0:0",
            " C420",
            " C422",
            " C444",
            " Cmono",
            " Ip",
            " It",
            " XCOLORRANGE=LIMITED",
            "\n",
            "16384",
            "99999999999999999999",
        ],
    },
    Format {
        name: "mcap",
        read: readers::mcap,
        seeds: seeds::mcap,
        words: &[
            "mono8",
            "rgb8",
            "bgr8",
            "yuyv",
            "nv12",
            "16UC1",
            "jpeg",
            "png",
            "protobuf",
            "foxglove.RawImage",
            "foxglove.CompressedImage",
            "width",
            "height",
            "16384",
            "-1",
            "lz4",
            "zstd",
            "nan",
        ],
    },
    Format {
        name: "jpeg",
        read: readers::jpeg,
        seeds: seeds::jpeg,
        words: &[],
    },
    Format {
        name: "png",
        read: readers::png,
        seeds: seeds::png,
        words: &[
            "IHDR", "PLTE", "tRNS", "sBIT", "IDAT", "IEND", "tEXt", "acTL", "fcTL", "fdAT",
        ],
    },
    Format {
        name: "svg",
        read: readers::svg,
        seeds: seeds::svg,
        words: &[
            "<g>",
            "</g>",
            "<svg>",
            "</svg>",
            "<path d='M0 0L9 0L9 9Z'/>",
            "<use href='#a'/>",
            " id='a'",
            " href='#a'",
            " fill='none'",
            " fill='#000'",
            " fill='url(#a)'",
            " stroke='#000'",
            " stroke-width='1e30'",
            " transform='scale(0)'",
            " transform='matrix(1e30 0 0 1e-30 0 0)'",
            " clip-path='url(#a)'",
            " mask='url(#a)'",
            " filter='url(#a)'",
            " viewBox='0 0 1e9 1'",
            " opacity='0'",
            "<!ENTITY a '&b;&b;'>",
            "&a;",
            "<style>",
            "NaN",
            "1e39",
            "-1e-39",
            "100%",
            "\u{fffd}",
            "A1 1 0 0 1 5 5",
            "C1 1 2 2 3 3",
            "<image href='a'/>",
            "<text>a</text>",
            "<pattern id='a' width='1e-9' height='1e-9'>",
            "<symbol id='a'>",
            "<clipPath id='a'>",
        ],
    },
    Format {
        name: "calibration",
        read: readers::calibration,
        seeds: seeds::calibration,
        words: &[
            "[[points]]\n",
            "pixel = ",
            "floor = ",
            "nan",
            "inf",
            "-inf",
            "1e308",
            "-1e308",
            "1e-308",
            "0.0",
            "[0.0, 0.0]",
            "9223372036854775807",
            "\"",
            "#",
            "points = []",
        ],
    },
    Format {
        name: "settings",
        read: readers::settings,
        seeds: seeds::settings,
        words: &[
            "nan",
            "inf",
            "-inf",
            "1e38",
            "-0.0",
            "0",
            "4294967295",
            "threshold = ",
            "learn = ",
            "plate_mm = ",
            "shadow = ",
            "\"",
            "[",
            "]",
            "\n",
        ],
    },
];

/// The format of a name.
#[must_use]
pub fn format(name: &str) -> Option<&'static Format> {
    FORMATS.iter().find(|format| format.name == name)
}
