/** What a user can cause: the message is one sentence that says what is wrong, what was expected and what to do. */
export class MipbakeError extends Error {
    /** @param {string} message */
    constructor(message) {
        super(message);
        this.name = 'MipbakeError';
    }
}
