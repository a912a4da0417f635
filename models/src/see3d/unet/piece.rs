//! Tokens that are worked on at a time.

use candle_core::{Result, Tensor};

/// Some tokens: of whole groups, of whole frames of a group, or of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Piece {
    /// The first.
    pub(super) group: usize,
    pub(super) groups: usize,
    /// The first within its group.
    pub(super) token: usize,
    /// Of each group.
    pub(super) tokens: usize,
}

impl Piece {
    /// All tokens of so many groups, frames in a group and pixels in a frame, in order, as pieces of at most
    /// `rows` tokens.
    pub(super) fn all(groups: usize, frames: usize, pixels: usize, rows: usize) -> Vec<Self> {
        let tokens = frames * pixels;
        if tokens <= rows {
            let step = rows / tokens.max(1);
            let piece = |group| Self {
                group,
                groups: step.min(groups - group),
                token: 0,
                tokens,
            };
            return (0..groups).step_by(step).map(piece).collect();
        }
        // Whole frames, or parts of one.
        let (span, step) = match pixels <= rows {
            true => (tokens, rows / pixels * pixels),
            false => (pixels, rows.max(1)),
        };
        let mut pieces = Vec::new();
        for group in 0..groups {
            for start in (0..tokens).step_by(span) {
                for token in (start..start + span).step_by(step) {
                    pieces.push(Self {
                        group,
                        groups: 1,
                        token,
                        tokens: step.min(start + span - token),
                    });
                }
            }
        }
        pieces
    }

    /// These of `tokens` (groups, tokens, channels).
    pub(super) fn of(&self, tokens: &Tensor) -> Result<Tensor> {
        tokens
            .narrow(0, self.group, self.groups)?
            .narrow(1, self.token, self.tokens)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_are_all_tokens_in_order() {
        for (groups, frames, pixels, rows) in [
            (2, 3, 20, 2048),
            (5, 3, 20, 130),
            (2, 3, 20, 47),
            (2, 3, 20, 7),
            (1, 1, 1, 1),
        ] {
            let mut next = 0;
            for piece in Piece::all(groups, frames, pixels, rows) {
                let tokens = frames * pixels;
                assert_eq!(piece.group * tokens + piece.token, next);
                assert!(piece.groups == 1 || piece.tokens == tokens);
                assert!(piece.groups * piece.tokens <= rows);
                // A piece has whole frames, or lies in one.
                let end = piece.token + piece.tokens;
                let whole = piece.token % pixels == 0 && end % pixels == 0;
                assert!(whole || piece.token / pixels == (end - 1) / pixels);
                next += piece.groups * piece.tokens;
            }
            assert_eq!(next, groups * frames * pixels);
        }
    }
}
